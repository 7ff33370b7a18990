"""One image under evaluation protocols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

from . import _arrays, _strat

if TYPE_CHECKING:
    # Of Python 3.11; nobody asks for it at run time.
    from typing import Unpack


class Meaning(NamedTuple):
    """What the numbers of a map are, in the words of the description beside saved predictions."""

    meaning: str
    sigmoid: tuple[float, float] | None = None
    scale: float | None = None
    stretched: bool = False


def _camera(focal_px: float | None, baseline_m: float | None) -> tuple[float, float] | None:
    if (focal_px is None) != (baseline_m is None):
        raise ValueError("a camera is focal_px and baseline_m; give both or neither")
    return None if focal_px is None or baseline_m is None else (float(focal_px), float(baseline_m))


class Options(TypedDict, total=False):
    """What :func:`evaluate` and :func:`evaluate_all` take by name beside protocol and meaning; the former says
    what each is."""

    focal_px: float | None
    baseline_m: float | None
    sigmoid: tuple[float, float] | None
    scale: float | None
    stretched: bool
    truth_meaning: str
    labels: Any
    metrics: bool


def evaluate(
    prediction: Any, truth: Any, *, protocol: str = "eigen-80", meaning: str, **options: Unpack[Options]
) -> dict[str, Any]:
    """Scores one predicted map under one protocol.

    :param prediction: floats of 16, 32 or 64 bits, rows and columns, at any size; an array, or what has
        ``__array__`` or DLPack, such as a tensor. It shows the whole image and is resized as the protocol
        says (PROTOCOL 3.3).
    :param truth: ground truth, floats, rows and columns of the image; 0 where nothing was measured.
    :param protocol: a name of :func:`protocols`, with suffixes, or a YAML file of your own.
    :param meaning: what the numbers of the prediction are: ``disparity_fraction`` (of the image width),
        ``disparity_px`` (pixels of the map's own width), ``inverse_depth`` (of unknown scale: scored under
        the protocol with ``-median``), ``inverse_depth_per_m`` (1/m), ``depth`` (of unknown scale) or
        ``depth_m`` (metres, 0 is none).
    :param focal_px: focal length in pixels of an image as wide as the truth. Needed where a protocol turns
        disparity into depth by the image's own camera.
    :param baseline_m: the stereo baseline in metres, with ``focal_px``.
    :param sigmoid: smallest and largest depth of a sigmoid that is to be undone first.
    :param scale: depth in metres is this many times the depth that the numbers say.
    :param stretched: a map as large as the image and yet of another aspect shows the whole image.
    :param truth_meaning: ``depth_m`` (the default), or ``disparity_px`` for the disparity of stereo 2015.
    :param labels: Cityscapes label ids, rows and columns of the image, for protocols with groups.
    :param metrics: measure the further metrics as well: ``silog``, ``log10``, ``irmse``, ``mae``, ``sq_rel_2``.
    :return: ``protocol``, ``group``, the metrics under the names of the columns of ``rows.csv``, ``pixels``
        and ``floored_pixels``, ``scale`` and ``shift`` by which the protocol aligned the map; None where the
        protocol has no such value or it was not asked for.
    :raises ValueError: a shape, type, number or word that cannot be used, or an image without a pixel to
        score; a protocol with several groups, for which there is :func:`evaluate_all`.
    :raises TypeError: an argument of another name.
    """
    scores = evaluate_all(prediction, truth, protocols=[protocol], meaning=meaning, **options)
    if len(scores) != 1 or scores[0]["group"] is not None:
        raise ValueError(f"protocol {protocol} scores groups of pixels; evaluate_all returns one score for each")
    return scores[0]


def evaluate_all(
    prediction: Any, truth: Any, *, protocols: Sequence[str], meaning: str, **options: Unpack[Options]
) -> list[dict[str, Any]]:
    """Scores one predicted map under several protocols, resizing it once where they allow it.

    The parameters are those of :func:`evaluate`. Returns what :func:`evaluate` returns for each protocol
    and, within one, for each group that occurs in the image.

    :raises ValueError: as :func:`evaluate`; also where one of the protocols cannot score the image.
    :raises TypeError: an argument of another name.
    """
    for name in options.keys() - Options.__annotations__.keys():
        raise TypeError(f'unknown argument "{name}"; known: {", ".join(Options.__annotations__)}')
    if isinstance(protocols, str):
        raise ValueError(f'protocols are a list of names; write ["{protocols}"]')
    truth_meaning = options.get("truth_meaning", "depth_m")
    if truth_meaning not in ("depth_m", "disparity_px"):
        raise ValueError(f'truth is depth_m or disparity_px, not "{truth_meaning}"')
    labels = options.get("labels")
    return _strat.evaluate(
        _named("prediction", _arrays.floats, prediction),
        _named("truth", _arrays.floats, truth),
        list(protocols),
        Meaning(meaning, options.get("sigmoid"), options.get("scale"), options.get("stretched", False)),
        _camera(options.get("focal_px"), options.get("baseline_m")),
        truth_meaning == "disparity_px",
        None if labels is None else _named("labels", _arrays.labels, labels),
        options.get("metrics", False),
    )


def _named(name: str, convert: Any, value: Any) -> Any:
    try:
        return convert(value)
    except ValueError as error:
        raise ValueError(f"the {name}: {error}") from None


def protocols() -> list[str]:
    """Names of the protocols; each also takes suffixes such as ``-median`` and ``-nocrop``."""
    return _strat.protocols()


def describe(protocol: str) -> str:
    """The rules of a protocol in words, with its version and digest.

    :raises ValueError: there is no such protocol.
    """
    return _strat.describe(protocol)
