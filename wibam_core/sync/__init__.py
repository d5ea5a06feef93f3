"""Signal changes in recordings, and from them every camera's clock."""
