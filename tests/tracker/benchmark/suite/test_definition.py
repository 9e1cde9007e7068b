"""The suite that comes with the package, and mistakes in one's own."""

import pytest
from benchmark_suite import TINY

from synthcam_shared.errors import InputError
from tracker.benchmark.suite.definition import merge_settings, parse_definition, read_definition


def test_the_packages_own_suite_covers_its_axes():
    full, small = read_definition(), read_definition(size="small")
    assert {"brightness", "blur", "noise", "codec", "lens", "scene"} == {name for name, *_ in full.axes()}
    assert {"contact", "spins", "collisions", "matte_wood", "h264_28", "mjpeg_10"} <= set(full.parts)
    assert set(small.parts) < set(full.parts)
    assert small.version == f"{full.version}-small"
    assert full.parts["h264_23"].truth == "codec"
    assert full.parts["peak_25"].clips == tuple(range(12, 18))  # the third scene of six clips each


def test_crowds_stand_apart_in_films_of_their_own():
    """No film has both, so the films of two balls are those of suites without crowds."""
    full, small = read_definition(), read_definition(size="small")
    crowds = {full.parts[name].film for name in full.crowds}
    assert len(full.crowds) == 10
    assert not crowds & {part.film for name, part in full.parts.items() if name not in full.crowds}
    assert [film.name for film in full.films][-len(crowds) :] == sorted(crowds)  # the seed of a film is by its number
    assert [[part for _, part in points] for _, points in small.crowd_axes()] == [[name] for name in small.crowds]
    assert not set(full.crowds) & {*full.headline, *full.parts_of("measured")}


def test_a_suite_made_before_there_were_crowds_has_none():
    old = parse_definition(TINY, "full", "tiny.yaml")
    assert (old.crowds, list(old.crowd_axes())) == ([], [])


def test_a_scene_over_the_films_own_replaces_values_and_keeps_the_rest():
    assert merge_settings({"a": {"x": 1, "y": {"uniform": [0, 1]}}}, {"a": {"y": 2}}) == {"a": {"x": 1, "y": 2}}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed: 5", "sed: 5", "seed is missing"),
        ("near: bright", "near: brigt", "brigt: no such scene, expected one of bright, dim"),
        ("clips: 2", "clips: 2\n    encode: {}", "films.axes: encode: unknown"),
        ("name: tiny", "name: [", "damaged, expected YAML"),
        ("sampled:", "crowds: {axes: {}}\nsampled:", "crowds: parts is missing, expected crowds: axes, parts"),
        ("sampled:", "crowds: {axes: {}, parts: {dum: x}}\nsampled:", "dum: no such scene, expected one of bright"),
    ],
)
def test_a_mistake_is_one_line(old, new, said):
    with pytest.raises(InputError, match=said) as caught:
        parse_definition(TINY.replace(old, new), "full", "tiny.yaml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("tiny.yaml: ")


def test_an_unknown_size():
    with pytest.raises(InputError, match="--size: expected one of full, small"):
        read_definition(size="huge")
