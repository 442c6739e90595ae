"""CITATION.cff cites this software, in its present version, and the paper."""

import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]


def test_the_citation_is_of_this_software_and_of_the_paper():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert cited["type"] == "software"
    assert cited["version"] == project["version"]
    assert cited["title"].startswith(f"{project['name']}:")
    assert "preferred-citation" not in cited  # it would be cited instead of the software
    (paper,) = cited["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Lei", "Chen", "Li", "Zheng"]
