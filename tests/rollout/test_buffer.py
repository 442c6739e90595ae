"""What environments did is kept as it was told."""

import numpy as np

from zoac.rollout.buffer import Recording


def test_a_diagnostic_is_kept_whatever_its_first_rows_held():
    record = Recording()
    rows = [np.zeros(2, int), np.array([0.5, 1.5]), np.array([2, 3])]
    words = [np.array(["ok", "ok"]), np.array(["stopped", "ok"]), np.array(["ok", "ok"])]
    for number, word in zip(rows, words, strict=True):
        record.append({"number": number, "word": word})
    cut = record.cut(0, 0)
    assert cut["number"].tolist() == [0.0, 0.5, 2.0]
    assert cut["word"].tolist() == ["ok", "stopped", "ok"]
