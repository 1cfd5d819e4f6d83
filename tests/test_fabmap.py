"""FAB-MAP: its formulas word by word, the tree on data with a known one, files and the trainer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file
from technique_files import fabmap
from weight_cases import image

from amusic_gym.techniques import make_technique
from amusic_gym.techniques.fabmap import local_features, words_of
from amusic_gym.techniques.fabmap_model import ChowLiuTree
from amusic_gym.techniques.weight_files import read_weights

ROOT = Path(__file__).resolve().parent.parent


def random_tree(seed, words=12, images=40):
    rng = np.random.default_rng(seed)
    return ChowLiuTree.learn(rng.random((images, words)) < rng.uniform(0.1, 0.9, words))


def p_observed(z, e, p, p_given_parent):
    """P(z | z of the parent, e), by openFABMAP's formula."""
    p_z = p if z else 1 - p
    p_given = p_given_parent if z else 1 - p_given_parent
    seen = {(1, 1): 0.39, (0, 1): 0.61, (1, 0): 0.0, (0, 0): 1.0}
    alpha = p_z * seen[1 - z, e] * (1 - p_given)
    beta = (1 - p_z) * seen[z, e] * p_given
    return beta / (alpha + beta)


def direct(tree, query, place):
    """Log-likelihood of a query at a place, term by term."""
    total = 0.0
    for q in range(len(tree.p)):
        p = tree.p[q]
        given_parent = (tree.p1 if query[tree.parent[q]] else tree.p0)[q]
        alpha = (0.39 if place[q] else 0.61) * p
        beta = (0.0 if place[q] else 1.0) * (1 - p)
        there = alpha / (alpha + beta)
        z = int(query[q])
        total += np.log(
            there * p_observed(z, 1, p, given_parent)
            + (1 - there) * p_observed(z, 0, p, given_parent)
        )
    return total


@settings(deadline=None)  # SciPy is loaded by the first
@given(st.integers(0, 1000))
def test_the_linear_form_is_the_likelihood(seed):
    rng = np.random.default_rng(seed)
    tree = random_tree(seed)
    query, place = rng.random((2, 12)) < 0.5
    weights, constant = tree.likelihood_terms(query)
    assert weights @ place + constant == pytest.approx(direct(tree, query, place), abs=1e-12)
    assert constant == pytest.approx(direct(tree, query, np.zeros(12, bool)), abs=1e-12)


@pytest.mark.parametrize("e", [0, 1])
def test_observations_of_a_word_sum_to_one(e):
    tree = random_tree(3)
    parent_seen = np.ones(12, bool)
    for seen in (np.ones(12, bool), np.zeros(12, bool)):
        there, not_there = tree._observation(seen)
        assert np.isfinite(there).all()
        assert np.isfinite(not_there).all()
    for p, given_parent in zip(tree.p, tree.p1, strict=True):
        both = p_observed(0, e, p, given_parent) + p_observed(1, e, p, given_parent)
        assert both == pytest.approx(1, abs=1e-12)
    ours = tree._observation(parent_seen)[1 - e]
    expected = [p_observed(1, e, p, g) for p, g in zip(tree.p, tree.p1, strict=True)]
    np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_one_word_by_hand():
    """p = .5 without a parent: P(z=1 | e) is .39 or 0; P(e | not seen) is .61/1.61."""
    tree = ChowLiuTree(np.array([0]), *(np.array([0.5]),) * 3)
    table = (True, 0.39, 0.39 * 0.61 / 1.61), (False, 0.61, 0.61**2 / 1.61 + 1 / 1.61)
    for query, seen, unseen in table:
        weights, constant = tree.likelihood_terms(np.array([query]))
        assert constant == pytest.approx(np.log(unseen), abs=1e-12)
        assert weights[0] + constant == pytest.approx(np.log(seen), abs=1e-12)
        new = np.log(0.5 * seen + 0.5 * (0.0 if query else 1.0))
        assert tree.new_place(np.array([query])) == pytest.approx(new, abs=1e-12)


def test_without_dependence_the_tree_is_naive_bayes():
    tree = random_tree(4)
    naive = ChowLiuTree(np.arange(12), tree.p, tree.p, tree.p)
    tied = ChowLiuTree(tree.parent, tree.p, tree.p, tree.p)
    query = np.random.default_rng(1).random(12) < 0.5
    for ours, theirs in zip(
        tied.likelihood_terms(query), naive.likelihood_terms(query), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_the_tree_of_sampled_data_is_found():
    """Words that copy their parent nine times in ten: 0 - 1 - 2 - 3, 1 - 4, and 5 alone."""
    rng = np.random.default_rng(0)
    parents = [None, 0, 1, 2, 1, None]
    seen = np.zeros((4000, 6), bool)
    for word, parent in enumerate(parents):
        seen[:, word] = rng.random(4000) < 0.5
        if parent is not None:
            copied = rng.random(4000) < 0.8
            seen[copied, word] = seen[copied, parent]
    tree = ChowLiuTree.learn(seen)
    edges = {frozenset((word, int(up))) for word, up in enumerate(tree.parent) if word != up}
    assert edges == {frozenset(edge) for edge in ((0, 1), (1, 2), (2, 3), (1, 4))}
    roots = [word for word, up in enumerate(tree.parent) if word == up]
    assert len(roots) == 2
    assert 5 in roots
    for word, parent in enumerate(tree.parent):
        if word == parent:
            assert tree.p1[word] == tree.p0[word] == tree.p[word]
            continue
        for states, given_parent in ((True, tree.p1), (False, tree.p0)):
            share = seen[seen[:, parent] == states, word].mean()
            assert given_parent[word] == pytest.approx(0.98 * share + 0.01, abs=1e-12)
    np.testing.assert_allclose(tree.p, 0.98 * seen.mean(0) + 0.01)


@settings(deadline=None)  # SciPy is loaded by the first
@given(st.integers(0, 50), st.integers(1, 30), st.integers(1, 30))
def test_a_tree_has_no_circle(seed, images, words):
    tree = random_tree(seed, words, images)
    for word in range(words):
        steps = 0
        while tree.parent[word] != word:
            word, steps = tree.parent[word], steps + 1
            assert steps < words
    for p in (tree.p, tree.p1, tree.p0):
        assert ((p > 0) & (p < 1)).all()


def test_the_dot_product_of_descriptors_is_the_log_likelihood(tmp_path):
    technique = make_technique("fabmap", fabmap(tmp_path))
    pictures = [cv2.resize(image(seed), (320, 240)) for seed in range(3)]
    places = np.stack([technique.describe(each) for each in pictures])
    words = [technique.words(each) for each in pictures]
    assert all(0 < each.sum() < len(each) for each in words)
    scores = technique.match(technique.describe_query(pictures[1]), places)
    expected = [direct(technique._tree, words[1], each) for each in words]
    np.testing.assert_allclose(scores, expected, rtol=1e-5)
    assert scores.argmax() == 1
    assert technique.new_place(pictures[1]) < scores[1]


def test_words_are_the_nearest():
    rng = np.random.default_rng(0)
    vocabulary, features = (rng.normal(size=(n, 5)).astype(np.float32) for n in (9, 4))
    nearest = {int(np.linalg.norm(vocabulary - each, axis=1).argmin()) for each in features}
    assert set(np.flatnonzero(words_of(features, vocabulary))) == nearest
    assert not words_of(features[:0], vocabulary).any()


def test_local_features_are_roots_of_length_one():
    found = local_features(cv2.resize(image(1), (320, 240)))
    assert found.shape[1] == 128
    assert len(found) > 10
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-4)
    assert local_features(np.full((20, 30, 3), 7, np.uint8)).shape == (0, 128)


def test_a_file_comes_back(tmp_path):
    path = fabmap(tmp_path)
    tree, vocabulary = ChowLiuTree.read(read_weights(path), 128)
    again = tree.save(tmp_path / "again.safetensors", vocabulary, "none")
    for name, array in load_file(path).items():
        np.testing.assert_allclose(load_file(again)[name], array, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parent": np.full(40, 40.0)}, "holds no tree of words"),
        ({"parent": np.full(40, 0.5)}, "holds no tree of words"),
        ({"parent": np.roll(np.arange(40.0), 1)}, "holds no tree of words"),
        ({"parent": np.array([1.0, 0.0, *[0.0] * 38])}, "holds no tree of words"),
        ({"p1": np.ones(40)}, "holds no tree of words"),
        ({"p0": np.full(39, 0.5)}, r"layer p0 of .* has shape \(39,\); FAB-MAP needs \(40\)"),
        ({"vocabulary": np.ones((40, 64))}, r"FAB-MAP needs \(any, 128\)"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, changes, message):
    path = fabmap(tmp_path)
    save_file({**load_file(path), **changes}, path)
    with pytest.raises(ValueError, match=message):
        make_technique("fabmap", path)


def test_without_a_vocabulary_it_says_how_to_make_one():
    with pytest.raises(ValueError, match=r"train_fabmap\.py --images DIR --out fabmap"):
        make_technique("fabmap")


def run(*words):
    return subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "train_fabmap.py"), *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_the_trainer_makes_a_vocabulary_twice_the_same(tmp_path):
    (tmp_path / "images").mkdir()
    for number in range(6):
        picture = cv2.resize(image(number), (320, 240))
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), picture)
    made = []
    for name in ("one", "two"):
        out = tmp_path / f"{name}.safetensors"
        done = run("--images", tmp_path / "images", "--out", out, "--words", 20)
        assert (done.returncode, done.stderr) == (0, "")
        assert f"--weights fabmap={out}" in done.stdout
        made.append(out.read_bytes())
    assert made[0] == made[1]
    technique = make_technique("fabmap", out)
    assert technique.describe(picture).shape == (21,)
    none = tmp_path / "none.safetensors"
    done = run("--images", tmp_path / "images", "--out", none, "--words", 9000)
    assert done.returncode == 2
    assert "local features for 9000 words; give more images, or fewer words" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not none.exists()
