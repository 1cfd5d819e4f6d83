"""Driving along a live route, as a robot would."""
