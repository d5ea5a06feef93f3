"""Celery workers: claim a stage, run it as a process of its own, publish its outputs, report."""
