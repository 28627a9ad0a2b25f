"""Pictures within a budget of time or error: pacing, error estimates, and the measured costs of a device."""
