"""Finding road users in images by ONNX networks: the bundled one, or a user's of any family of `detector`."""
