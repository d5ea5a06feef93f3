"""The pipeline: one module per stage, the graph, the store of outputs, and what runs them."""
