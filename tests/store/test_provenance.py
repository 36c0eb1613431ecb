"""The processor's name in the manifest says which one it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from topcli.store.provenance import cpu_name

X86 = "processor\t: 0\nmodel name\t: AMD EPYC 7763\nflags\t\t: fpu\n"
ARM = "processor\t: 0\nCPU implementer\t: 0x41\nCPU variant\t: 0x3\nCPU part\t: 0xd0c\nCPU revision\t: 1\n"


@pytest.mark.parametrize(("text", "name"), [(X86, "AMD EPYC 7763"), (ARM, "aarch64 Arm part 0xd0c variant 0x3 r1")])
def test_the_processor_is_named(monkeypatch: pytest.MonkeyPatch, text: str, name: str) -> None:
    monkeypatch.setattr(Path, "read_text", lambda self, **options: text)
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert cpu_name() == name
