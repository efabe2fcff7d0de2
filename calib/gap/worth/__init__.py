"""Attribution of the gap to effects: shares, rivals, probabilities, and attitude errors of amplitudes."""
