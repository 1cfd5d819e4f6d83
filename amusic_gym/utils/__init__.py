"""What every part may use: argument checks, files on disk, names, threads."""
