"""Every file that a stage leaves, declared once: who makes it, how it is read and written, what a person calls it.

Stages, the report, the API and the command line name artifacts, never files: `catalogue` declares them, `access`
reads and writes them.
"""
