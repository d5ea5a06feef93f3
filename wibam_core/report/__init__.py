"""Figures and the self-contained HTML report. Drawing takes nouns and returns pictures; only `assemble` reads files."""
