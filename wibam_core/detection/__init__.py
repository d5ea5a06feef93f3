"""2D vehicle detection by ONNX networks: the bundled one, or a user's of the YOLOX family."""
