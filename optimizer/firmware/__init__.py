"""The loops that firmware of others runs: structure, gains within it, margins."""
