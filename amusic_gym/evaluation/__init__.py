"""What policies come to: traces, metrics, comparisons, studies, figures and pages."""
