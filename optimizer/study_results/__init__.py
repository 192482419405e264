"""What the rows of a study say together: shares with intervals, sensitivities, fronts."""
