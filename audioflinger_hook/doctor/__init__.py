"""`cushion doctor`: reads the facts of a set-up, and finds what is wrong with it."""
