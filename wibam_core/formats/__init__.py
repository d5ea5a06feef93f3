"""Every import and export format, and every legacy convention."""
