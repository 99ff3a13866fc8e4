"""Sounds on which the benchmarks measure."""
