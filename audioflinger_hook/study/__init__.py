"""Studies with people: design, trials, sessions, estimates and report of `cushion study`."""
