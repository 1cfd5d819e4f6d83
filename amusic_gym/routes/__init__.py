"""Where routes come from: simulated scores, rendered worlds, image folders, data sets, video."""
