"""Train the CALC that ships, on rendered worlds and random collages only."""

from _cli import Parser, destination, run

from amusic_gym.pretraining import add_arguments, train


def main(words: list[str] | None = None) -> None:
    """Parse, train, say where the weights are."""
    parser = Parser(description=__doc__)
    add_arguments(parser, destination)
    train("calc", parser.parse_args(words))


if __name__ == "__main__":
    run(main)
