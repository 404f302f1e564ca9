"""One log into one folder of results, and many of them."""
