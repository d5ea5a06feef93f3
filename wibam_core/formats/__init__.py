"""Files that this project writes and reads back itself; formats of others are in `wibam_core.exchange`."""
