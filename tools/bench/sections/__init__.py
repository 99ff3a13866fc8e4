"""The sections of the report: each function measures one and returns it."""
