"""The pictures of the report. Only the module `pictures` can be imported without matplotlib."""
