"""The paper's experiments, run again: tables II and III, figures 3 to 7, and a sweep of E and M."""
