"""Loss comparisons at points, over maps and missions."""
