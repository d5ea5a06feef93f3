"""Networks, decoders, weights and inference."""
