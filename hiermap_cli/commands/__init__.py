"""One thin module a command; the work is done by library functions below."""
