"""`cushion doctor`: reads the facts of a set-up, and finds its faults."""
