"""Where routes come from: so far `amusic_gym.routes.simulate`, at the level of scores."""
