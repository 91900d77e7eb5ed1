"""Policies that learn to assemble: what they see, how they are taught, and how they are kept."""
