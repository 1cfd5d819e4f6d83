"""Score banks: the similarity of every query frame to every place; their files."""
