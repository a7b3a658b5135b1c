"""Made-up rows of probes and of executed validation plans, with errors that some of the measures tell."""

import numpy as np
import pandas as pd

from clothkit.dataset.tasks import TASKS
from clothkit.evaluation.tidy import PROBE_KINDS
from clothkit.planning.error_map import fit
from clothkit.planning.trust import least_of, of_error


def probe_rows(sequences: int = 6, seed: int = 0) -> pd.DataFrame:
    """Two probes of each kind and start, random ones of three manipulations; the distance tells their errors."""
    rng, rows = np.random.default_rng(seed), []
    for sequence in range(sequences):
        for kind in PROBE_KINDS:
            for start in range(3):
                for step in range(1, 4 if kind == "random" else 2):
                    unlike = kind != "recorded" and (kind != "random" or step > 1)
                    error = rng.uniform(0.02, 0.1) * (1 + unlike)
                    rows.append(
                        {
                            "sequence": sequence,
                            "start": start,
                            "kind": kind,
                            "step": step,
                            "error": error,
                            "error_0": 1.1 * error,
                            "error_1": 1.2 * error,
                            "difference": rng.uniform(0.1, 0.2),
                            "deviations": rng.normal(),
                            "conditional": np.log(error) + 0.3 * rng.normal(),
                            "distance": error * rng.uniform(0.8, 1.2),
                            "sigma": rng.uniform(0.02, 0.03),
                            "surprise": 3 * unlike + rng.uniform(0, 2),
                            "expected": error * rng.uniform(0.9, 1.1),
                        }
                    )
    return pd.DataFrame(rows)


def trust_rows(sequences: int = 6, seed: int = 0) -> pd.DataFrame:
    """All tasks of some sequences, of which about the real error was expected."""
    rng = np.random.default_rng(seed)
    tasks = [(sequence, start, length) for sequence in range(sequences) for start, length in TASKS]
    sequence, start, length = np.array(tasks).T
    expected = rng.uniform(0.01, 0.1, len(tasks))
    error = expected * rng.lognormal(0, 0.3, len(tasks))
    signs = {"expected": expected, "sigma": np.full(len(tasks), 0.02)}
    told = of_error(fit(signs, least_of(tuple(signs)), length - 1, error), expected)
    columns = {"sequence": sequence, "start": start, "length": length, **signs, "model_error": np.nan, "error": error}
    trusted = {f"trusted_{name}": values for name, values in told._asdict().items()}
    return pd.DataFrame({**columns, "error_no_action": 0.3, **trusted})
