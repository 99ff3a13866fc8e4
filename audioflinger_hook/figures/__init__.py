"""Pictures of what was played and felt. They need matplotlib, so import `figures.report` late."""
