"""Train the NetVLAD that ships, on rendered worlds and random collages only."""

from functools import partial

from _cli import run, train_weights

main = partial(train_weights, "netvlad", __doc__)

if __name__ == "__main__":
    run(main)
