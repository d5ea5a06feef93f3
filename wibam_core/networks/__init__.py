"""3D networks, a package each: how it finds vehicles, and how it is trained."""
