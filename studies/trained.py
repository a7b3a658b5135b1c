"""Nets that a study trains by itself, beside those of the chain."""

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import jax
from fingerprint import COLUMN

from clothkit.dataset.store import Dataset
from clothkit.models import ensemble
from clothkit.models import store as net_store
from clothkit.models.net import Net
from clothkit.params import Params
from clothkit.runtime.publish import alone, publish, unfinished
from clothkit.runtime.stage import WORK
from clothkit.training.loop import CHECKPOINT
from clothkit.training.pemd import train_pemd
from clothkit.training.recalibration import recalibrated
from clothkit.training.vtm import train_vtm


def is_trained(folder: Path, current: str) -> bool:
    """Return whether there is a net of a study in the folder, trained with the current data and settings."""
    return (folder / net_store.ATTRIBUTES).exists() and net_store.description(folder).get(COLUMN) == current


def cost_beside(folder: Path) -> Path:
    """Return the file with the seconds that the training of the net in `folder` took."""
    return folder.with_name(f"{folder.name}.json")


def train(
    nets: Path, member: int, params: Params, training: Callable[[], Dataset], validation: Dataset, current: str
) -> None:
    """Train a net as the train_pemd stage does, unless it is there, into nets/pemd/<member>.

    `training` loads the augmented training split, and `current` is the fingerprint of data and settings. What the
    training took is written beside the net; it is null for one that was resumed, since its earlier parts were not
    measured.
    """
    folder, settings = ensemble.folder(nets, "pemd", member), params.stages.train_pemd
    work = WORK / "studies" / nets.name / f"{member}_{current}"
    with alone(work.with_name(f"{work.name}.lock")):
        if is_trained(folder, current):
            return
        work.mkdir(exist_ok=True)
        whole = not (work / CHECKPOINT).exists()
        print(f"{folder}: {'training' if whole else 'training goes on from its checkpoint'}", flush=True)
        key = jax.random.fold_in(jax.random.key(settings.training.seed), member)
        wall, cpu = time.perf_counter(), time.process_time()
        trained = train_pemd(settings, training(), validation, work=work, key=key)
        cost = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
        attributes = {
            "stage": f"studies/{nets.name}",
            "scale": params.scale,
            "params": params.section("train_pemd"),
            "validation_score": trained.score,
            COLUMN: current,
        }
        net_store.save(work / "net", Net(settings.net, trained.params), trained.history, attributes)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with unfinished(cost_beside(folder)) as part:
            part.write_text(json.dumps({name: round(value, 1) if whole else None for name, value in cost.items()}))
        publish(work / "net", folder)
        shutil.rmtree(work)


def train_estimator(
    folder: Path, seed: int, params: Params, training: Dataset, validation: Dataset, current: str
) -> Net:
    """Return VtM trained as the train_vtm stage does, but with that seed; it is trained unless it is in `folder`."""
    settings, study = params.stages.train_vtm, folder.parent.name
    work = WORK / "studies" / study / f"{folder.name}_{current}"
    with alone(work.with_name(f"{work.name}.lock")):
        if is_trained(folder, current):
            return net_store.load(folder)
        work.mkdir(exist_ok=True)
        print(f"{folder}: training", flush=True)
        trained = train_vtm(settings, training, validation, work=work, key=jax.random.key(seed))
        net = Net(settings.net, trained.params)
        net = recalibrated(net, validation) if settings.recalibrate else net
        attributes = {
            "stage": f"studies/{study}",
            "scale": params.scale,
            "params": params.section("train_vtm"),
            "seed": seed,
            "validation_score": trained.score,
            COLUMN: current,
        }
        net_store.save(work / "net", net, trained.history, attributes)
        folder.parent.mkdir(parents=True, exist_ok=True)
        publish(work / "net", folder)
        shutil.rmtree(work)
        return net
