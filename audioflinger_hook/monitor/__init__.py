"""The live page: it shows and changes the state of a running daemon, from a separate process."""
