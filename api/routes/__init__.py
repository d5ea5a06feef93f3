"""The routes. They translate between HTTP and the adapters, and decide nothing."""
