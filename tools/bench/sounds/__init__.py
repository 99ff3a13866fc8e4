"""The sounds that are measured."""
