"""The sections of the report. Each function measures a section and returns it."""
