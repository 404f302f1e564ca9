"""Pictures and reports beyond map.svg."""
