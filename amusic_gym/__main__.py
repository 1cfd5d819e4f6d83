"""``python -m amusic_gym`` is the command ``amusic``."""

from amusic_gym.cli import main

if __name__ == "__main__":
    main()
