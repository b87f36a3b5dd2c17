"""Rewards learned from a person's feedback: inputs, network ensemble, losses, training, queries."""
