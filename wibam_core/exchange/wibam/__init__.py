"""The published WIBAM data set."""
