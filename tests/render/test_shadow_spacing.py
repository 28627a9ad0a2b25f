"""How many samples of each mesh cast shadows."""

import numpy as np
import pytest

from pointsplat_addon.render.shadows import _share


def test_small_meshes_keep_their_samples_and_large_ones_share_the_rest():
    asked = np.array([5e6, 1000.0, 300_000.0, 2e6])
    each = _share(asked, 1e6)
    got = np.minimum(asked, each)
    assert got.sum() == pytest.approx(1e6)
    assert got[1:3].tolist() == [1000.0, 300_000.0]
    assert got[0] == got[3]


def test_where_all_fit_none_is_coarser():
    asked = np.array([10.0, 20.0])
    assert (np.minimum(asked, _share(asked, 1e6)) == asked).all()
