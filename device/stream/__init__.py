"""Audio streams through PortAudio, on a sound server or straight on a card."""
