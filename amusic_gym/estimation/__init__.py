"""From score rows to a place: SIC and MuSIC, or a belief over places."""
