"""Pictures of sound and vibration. They need matplotlib, so import `figures.report` late."""
