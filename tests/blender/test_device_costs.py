"""What a device was measured to cost is kept as text, and broken text is as good as none."""

import json
from dataclasses import asdict

import pytest

from pointsplat_addon.core.lod.cost import Costs
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.host.device import device_costs


def test_figures_come_back_as_they_were():
    costs = Costs(point=1.5, draw=0.25)
    assert device_costs.parsed(json.dumps({"A GPU, OpenGL 430": asdict(costs)})) == {"A GPU, OpenGL 430": costs}


@pytest.mark.parametrize(
    "text", ["", "no table", "[]", '{"a": 1}', '{"a": {"point": -1}}', '{"a": {"point": "x"}}', '{"a": {"other": 1}}']
)
def test_what_is_no_table_of_positive_numbers_is_left_out(text):
    assert device_costs.parsed(text) == {}


def test_costs_matter_only_where_another_technique_than_the_visibility_buffer_may_draw():
    assert not device_costs.matter(Settings())
    assert not device_costs.matter(Settings(technique="VISIBILITY"))
    others = (
        Settings(technique="IMAGE_SPACE"),
        Settings(technique="EWA"),
        Settings(budget="TIME"),
        Settings(dof_method="LENS_SAMPLES"),
    )
    assert all(map(device_costs.matter, others))
