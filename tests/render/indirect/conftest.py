"""What tests of indirect light share: how much is gathered."""

import pytest

from pointsplat_addon.render.indirect.light import IndirectLight


@pytest.fixture
def gathered(monkeypatch) -> list[int]:
    """Receivers of each gather."""
    counts: list[int] = []

    def counting(gather):
        def counted(self, position, *args, **named):
            counts.append(len(position))
            return gather(self, position, *args, **named)

        return counted

    for name in ("gathered", "bounced", "moments"):
        monkeypatch.setattr(IndirectLight, name, counting(getattr(IndirectLight, name)))
    return counts
