"""The pages: templates, styles and ES modules. They use the public API and nothing else, and load nothing from
anywhere else."""
