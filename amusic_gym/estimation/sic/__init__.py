"""SIC and MuSIC (A-MuSIC, III-A and III-B), for one technique and for a batch of routes."""
