"""Policies that learn to assemble: their protocol, their training, their checkpoints."""
