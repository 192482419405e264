"""Observers of speed and position: design, judgement, proof."""
