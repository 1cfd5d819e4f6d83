"""Learned selectors: Stable-Baselines3 on the native vector environment."""
