"""Pictures of sound and vibration. Importing `figures.report` is slow: it loads matplotlib."""
