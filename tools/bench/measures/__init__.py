"""Functions that compute properties of sounds, vibrations and simulated rigs."""
