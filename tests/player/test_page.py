import resource

import numpy as np
import pytest
from page_reader import clip_titles, player_data

from drake_exo.player import Arrow, Clip, Page, Surface, write_page

TIMES = np.array([0.0, 0.5, 1.0])
POSE = np.tile([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0], (3, 1))
BARE = "<html><body><script>var viewer;</script></body></html>"
PAGE = Page("A </script> title & more", (1, 2, 3), (0, 0, 0))


def clip(**change):
    given = {
        "title": "one",
        "group": "all",
        "times": TIMES,
        "bodies": {"/a": POSE},
    }
    return Clip(**(given | change))


def test_numbers_survive(tmp_path):
    force = np.arange(18.0).reshape(3, 6)
    force[1] = np.nan
    arrow = Arrow("push", "a push", "#112233", 1e-3)
    page = Page("t", (1, 2, 3), (0, 0, 0), arrows=(arrow,))
    path = tmp_path / "page.html"
    write_page(path, BARE, page, [clip(arrows={"push": force})])
    found = player_data(path)
    assert found["bodies"] == ["/a"]
    np.testing.assert_allclose(
        found["clips"][0]["bodies"]["/a"].reshape(3, 7), POSE, rtol=1e-7
    )
    np.testing.assert_array_equal(
        found["clips"][0]["arrows"]["push"].reshape(3, 6), force
    )


def test_surface_is_exact_to_a_part_in_65535(tmp_path):
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.1, 0.3, (3, 8, 3))
    values = rng.uniform(0.0, 1.0, (3, 8))
    surface = Surface(np.array([[0, 1, 2]]), places, values)
    path = tmp_path / "page.html"
    write_page(path, BARE, PAGE, [clip(surfaces={"/s": surface})])
    found = player_data(path)["clips"][0]["surfaces"]["/s"]
    back = np.array(found["low"]) + (
        found["places"].reshape(3, 8, 3) / 65535 * np.array(found["span"])
    )
    np.testing.assert_allclose(back, places, atol=0.4 / 65535)
    np.testing.assert_allclose(
        found["values"].reshape(3, 8) / 65535, values, atol=1 / 65535
    )


def test_titles_cannot_break_the_page(tmp_path):
    path = tmp_path / "page.html"
    note = "</script><b>"
    write_page(path, BARE, PAGE, [clip(title="<i>", note=note)])
    assert clip_titles(path) == {"all": ["&lt;i&gt;"]}
    assert player_data(path)["clips"][0]["note"] == note
    text = path.read_text()
    assert "<h1>A &lt;/script&gt; title &amp; more</h1>" in text
    assert text.count("</body>") == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times": TIMES[::-1]}, "increasing"),
        ({"times": TIMES[:1]}, "at least two"),
        ({"bodies": {"/a": POSE[:2]}}, r"\(3, 7\)"),
        ({"arrows": {"push": POSE}}, r"\(3, 6\)"),
        ({"bodies": {"/a": np.full_like(POSE, np.inf)}}, "infinite"),
    ],
)
def test_wrong_clip_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        clip(**change)


def test_page_without_clips_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least one clip"):
        write_page(tmp_path / "page.html", BARE, PAGE, [])


def test_a_page_stays_where_another_one_does_not_fit(tmp_path):
    path = tmp_path / "page.html"
    write_page(path, BARE, PAGE, [clip()])
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            write_page(path, BARE, PAGE, [clip(note="another")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
