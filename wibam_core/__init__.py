"""Everything about cameras, vehicles and learning: the core of the WIBAM service."""

__version__ = "0.8.0"
