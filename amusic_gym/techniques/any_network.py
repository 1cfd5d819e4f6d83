"""Any network as a technique: a TorchScript or ONNX file, or an entry of torch.hub.

What the file does not say stands in a :mod:`recipe <amusic_gym.techniques.recipe>` beside it.
"""

import contextlib
import hashlib
import io
import os
import socket
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from amusic_gym.techniques.own_code import told
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.recipe import Recipe
from amusic_gym.utils.names import suggest
from amusic_gym.utils.reading import open_file

RECIPES = Path(__file__).parent / "recipes"
DEVICES = ("cpu", "cuda")
BATCH = 16  # images that a GPU describes at once
Run = Callable[[torch.Tensor], Any]  # (B, 3, H, W) -> a network's outputs


class _Network(Technique):
    """A network behind a recipe; ``argument`` stands behind the technique's name.

    Descriptors of the devices ``"cpu"`` and ``"cuda"`` differ in their last digits. ``trust``:
    whether foreign code may run.
    """

    def __init__(self, argument: str, device: str = "cpu", trust: bool = False) -> None:
        if device not in DEVICES:
            raise ValueError(suggest("device", device, DEVICES))
        if device == "cuda" and not torch.cuda.is_available():
            raise ValueError("PyTorch finds no GPU; leave out --device cuda")
        self._made = argument, device, trust
        self._device = device
        self.batch = BATCH if device == "cuda" else 1
        self._recipe, self._digest, self._run = self._open(argument, trust)
        self.name = self._recipe.name

    def _open(self, argument: str, trust: bool) -> tuple[Recipe, str, Run]:
        """The recipe, a digest of all that the network is, and the network."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        """By its arguments: a network need not pickle."""
        return _opened_again, (type(self), self._made, self.parameters())

    def parameters(self) -> Parameters:
        """Digests of the network and of its recipe, and the device."""
        return {"network": self._digest, "recipe": self._recipe.digest, "device": self._device}

    def describe(self, image: Image) -> Descriptor:
        """(D,) float32, of length 1 where the metric is the cosine."""
        return self.describe_batch([image])[0]

    def describe_batch(self, images: Sequence[Image]) -> list[Descriptor]:
        """Descriptors of several images, computed at once where they become one size.

        Raises:
            ValueError: for an array that is no image, or a network that gives no descriptor.
        """
        inputs = [self._recipe.input.apply(image) for image in images]
        if len({x.shape for x in inputs}) == 1:
            return self._described(torch.stack(inputs))
        return [self._described(x[None])[0] for x in inputs]

    def _described(self, prepared: torch.Tensor) -> list[Descriptor]:
        """(B, 3, H, W) -> B descriptors."""
        try:
            with torch.inference_mode():
                outputs = self._run(prepared.to(self._device))
        except Exception as error:  # whatever the network's code raises
            raise ValueError(
                f"the network of {self.name} cannot describe images of shape "
                f"{tuple(prepared.shape)}: {told(error)[:300]}; is the recipe's size right?"
            ) from error
        chosen = self._chosen(outputs)
        if chosen.ndim < 2 or len(chosen) != len(prepared):
            raise ValueError(
                f"the network of {self.name} gives shape {chosen.shape} for {len(prepared)} "
                "images; choose another output in the recipe"
            )
        return [self._recipe.finish(each.ravel()) for each in chosen]

    def _chosen(self, outputs: Any) -> NDArray[Any]:
        """The recipe's output as an array."""
        output = self._recipe.output
        if isinstance(outputs, torch.Tensor | np.ndarray):
            outputs = [outputs]
        try:
            found = outputs[output]
        except (KeyError, IndexError, TypeError):
            valid = list(outputs) if isinstance(outputs, dict) else list(range(len(outputs)))
            raise ValueError(
                f"the network of {self.name} has no output {output!r}, which the recipe names; "
                f"there are {valid}"
            ) from None
        return found.float().cpu().numpy() if isinstance(found, torch.Tensor) else np.asarray(found)

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """(B,) similarities by the recipe's metric."""
        return self._recipe.match(query, references)


def _opened_again(kind: type[_Network], made: tuple[Any, ...], known: Parameters) -> _Network:
    technique = kind(*made)
    if technique.parameters() != known:
        raise ValueError(f"the files of technique {technique.name!r} changed; start again")
    return technique


def _file(argument: str) -> tuple[Path, bytes, Recipe]:
    """A network's file and the recipe beside it."""
    path = Path(argument)
    with open_file(path) as file:
        data = file.read()
    recipe = path.with_suffix(".toml")
    if not recipe.is_file():
        raise FileNotFoundError(
            f"{recipe} does not exist; write what {path.name} takes: size = [HEIGHT, WIDTH], and "
            "mean, std, output and metric where they are not ImageNet's, 0 and cosine"
        )
    return path, data, Recipe.read(recipe, path.stem)


def _refused(path: Path, kind: str, error: Exception) -> ValueError:
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return ValueError(f"{path} is no {kind} that can be run ({reason}); export it again")


class TorchScript(_Network):
    """A network that ``torch.jit.save`` wrote: ``torchscript:FILE``.

    Its own code runs in PyTorch's interpreter, which knows tensors and no Python.
    """

    def _open(self, argument: str, trust: bool) -> tuple[Recipe, str, Run]:
        path, data, recipe = _file(argument)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)
                load: Any = torch.jit.load  # untyped
                network = load(io.BytesIO(data), map_location=self._device).eval()
        except (RuntimeError, ValueError) as error:
            raise _refused(path, "TorchScript file", error) from None
        return recipe, hashlib.sha256(data).hexdigest(), network


class ONNX(_Network):
    """A network in ONNX: ``onnx:FILE``, by the optional part ``onnx``, ONNX Runtime."""

    def _open(self, argument: str, trust: bool) -> tuple[Recipe, str, Run]:
        try:
            import onnxruntime as ort
        except ImportError:
            raise ValueError(
                'the technique onnx needs ONNX Runtime; install it: pip install "amusic-gym[onnx]"'
            ) from None
        path, data, recipe = _file(argument)
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # bits depend on it
        options.log_severity_level = 4
        provider = "CUDAExecutionProvider" if self._device == "cuda" else "CPUExecutionProvider"
        if provider not in ort.get_available_providers():
            raise ValueError(
                "this ONNX Runtime finds no GPU; install onnxruntime-gpu, or leave out "
                "--device cuda"
            )
        try:
            session = ort.InferenceSession(data, options, providers=[provider])
            names = [each.name for each in session.get_outputs()]
            (taken,) = [each.name for each in session.get_inputs()]
        except Exception as error:  # onnxruntime has an exception for each status
            raise _refused(path, "ONNX network of one input", error) from None

        def run(images: torch.Tensor) -> Any:
            outputs = session.run(None, {taken: images.cpu().numpy()})
            named = isinstance(recipe.output, str)
            return dict(zip(names, outputs, strict=True)) if named else outputs

        return recipe, hashlib.sha256(data).hexdigest(), run


class Hub(_Network):
    """An entry of torch.hub: ``hub:OWNER/REPO:ENTRY[:NAME=VALUE...]``.

    The repository is a folder of that name, or is in the hub's cache; nothing is downloaded, not
    by its code either. That code is Python and may do anything: it runs only with ``trust``. The
    recipe is ``FOLDER.toml`` beside the repository's folder, else one that ships.
    """

    def _open(self, argument: str, trust: bool) -> tuple[Recipe, str, Run]:
        repository, _, rest = argument.partition(":")
        entry, *pieces = rest.split(":")
        if not (repository and entry) or not all("=" in piece for piece in pieces):
            raise ValueError(
                f"hub:{argument} is not of the form hub:OWNER/REPO:ENTRY or "
                "hub:OWNER/REPO:ENTRY:NAME=VALUE"
            )
        if not trust:
            raise ValueError(
                f"hub:{repository} runs Python code of {repository}, which may do anything; say "
                "that you trust its authors: --trust, or trust=True in Python"
            )
        folder = _clone(repository)
        beside = folder.with_name(f"{folder.name}.toml")
        shipped = RECIPES / f"{repository.replace('/', '_').casefold()}.toml"
        if not beside.is_file() and not shipped.is_file():
            raise FileNotFoundError(
                f"{beside} does not exist; write what the network takes: size = [HEIGHT, WIDTH]"
            )
        recipe = Recipe.read(beside if beside.is_file() else shipped, folder.name)
        options = {name: _plain(text) for name, _, text in (p.partition("=") for p in pieces)}
        try:
            with _offline(), contextlib.redirect_stdout(io.StringIO()):
                load: Any = torch.hub.load  # untyped
                network = load(str(folder), entry, source="local", **options)
        except Exception as error:  # whatever that code raises
            raise ValueError(
                f"hub:{repository}:{entry} cannot be made: {told(error)[:300]}; what is missing "
                "of it, download once, by torch.hub.load in Python"
            ) from error
        network = network.to(self._device).eval().requires_grad_(False)
        return recipe, _digest(folder, network, options), network


def _clone(repository: str) -> Path:
    """The folder of a repository, here or in the hub's cache."""
    if os.path.isdir(repository):
        return Path(repository).resolve()
    cache = Path(torch.hub.get_dir())
    found = sorted(cache.glob(f"{repository.replace('/', '_')}_*")) if "/" in repository else []
    found = [each for each in found if each.is_dir()]
    if len(found) > 1:
        raise ValueError(
            f"the hub's cache {cache} has several copies of {repository}: "
            f"{', '.join(each.name for each in found)}; give the path of one"
        )
    if not found:
        raise FileNotFoundError(
            f"{repository} is neither a folder nor in the hub's cache {cache}, and nothing is "
            f"downloaded here; clone it, or once: torch.hub.list({repository!r}) in Python"
        )
    return found[0]


def _digest(folder: Path, network: torch.nn.Module, options: dict[str, Any]) -> str:
    """Of the repository's code, the weights and the arguments."""
    digest = hashlib.sha256(repr(sorted(options.items())).encode())
    for file in sorted(folder.rglob("*.py")):
        digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    for name, tensor in network.state_dict().items():
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy())
    return digest.hexdigest()


def _plain(text: str) -> int | float | bool | str:
    """A number, True or False where the text is one."""
    if text in ("True", "False"):
        return text == "True"
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


@contextlib.contextmanager
def _offline() -> Iterator[None]:
    """Refuse every look-up of a host, so that code which downloads fails instead."""

    def refuse(host: Any, *_: Any, **__: Any) -> Any:
        raise OSError(f"it asks {host} for a download, which is not done here")

    before = socket.getaddrinfo
    socket.getaddrinfo = refuse
    try:
        yield
    finally:
        socket.getaddrinfo = before
