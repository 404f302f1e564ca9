"""hiermap: landmark, area and environment models from recorded robot logs."""

__version__ = "0.1.0"
