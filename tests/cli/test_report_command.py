"""``navrl-report``: what others are compared with if nobody says."""

import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.cli.report import main

pytest.importorskip("plotly", reason="needs the extra report")


def test_policies_are_compared_without_the_paper_too(tmp_path, capsys):
    write_evaluation(tmp_path / "a", "dwa", [WON] * 8)
    write_evaluation(tmp_path / "b", "random", [HIT] * 7 + [WON])
    main([str(tmp_path)])
    assert "success vs dwa" in (tmp_path / "report.html").read_text()
    with pytest.raises(SystemExit):
        main([str(tmp_path), "--reference", "paper"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "navrl: reference=paper: must be one of these policies; there are dwa, random"
