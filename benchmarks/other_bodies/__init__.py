"""Recordings of vehicles that no network, template or prior of ours has seen: other bodies, another renderer.

Bodies are lofted along the side profiles of real models (`catalogue`, `bodies`), which are drawn by a z-buffer with a
normal, a material and a reflection at every pixel (`raster`, `materials`, `light`), on textured ground between textured
buildings (`surroundings`), while they drive as rolling wheels do (`driving`). Nothing here imports
`wibam_core.synthetic`, by which the networks learned. `record` writes a site that `wibam run` takes, with its truth.
"""
