"""Processing of whole files: rendering, also in batches, and lists of principal frequencies."""
