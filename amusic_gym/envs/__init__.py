"""The Gymnasium environments, single and vector, and where their routes come from."""
