"""What is kept of a site, so that one notices later when a camera was turned or sees worse than it did."""
