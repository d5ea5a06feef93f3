"""Typed documents: what stages write as JSON, and what the API, the client, the command line and the report show.

Every field is declared here, once, with its unit in its name. A document is built by the package that computes it,
written and read through `wibam_core.artifacts`, and is what the API's schema shows.
"""
