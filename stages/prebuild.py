"""Packs the nets of system main into small files, and measures what that costs: `python stages/prebuild.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.planning.objective import Weights
from clothkit.planning.planner import assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.prebuilt.deviation import check, deviations
from clothkit.prebuilt.files import SECTIONS, check_size, pack, sources, unpack
from clothkit.prebuilt.manifest import manifest_of, write
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")


def main() -> None:
    """Write prebuilt/<scale>/."""
    with stage("prebuild") as s:
        target, members, stages = Path("prebuilt") / s.shared.scale, s.shared.ensemble.members, s.shared.stages
        if s.params is None:
            s.leave_out(target)
            return
        inputs = {f"data/{name}": DATA / name for name in sources(members)}
        work = s.work(inputs=list(inputs.values()))
        files, data = work / "files", work / "data"
        pack(DATA, files, members, half=s.params.half)
        check_size(files, megabytes=s.params.megabytes)
        unpack(files, data, members)
        weights = Weights(s.shared.alpha, s.shared.beta, s.shared.gamma)
        settings = (weights, stages.plan, stages.simulate.candidates, members)
        found = deviations(
            assemble(SYSTEMS["main"], DATA, *settings),
            assemble(SYSTEMS["main"], data, *settings),
            store.load(DATA / "meshes.zarr").of_split("validation"),
            sequences=s.params.sequences,
            executed=s.params.executed,
            execute=make_simulator(stages.simulate),
        )
        end_workers()
        check(found, within=s.params.within)
        params = {name: s.shared.section(name) for name in SECTIONS}
        scale = s.shared.scale
        made = manifest_of(files, scale=scale, members=members, sources=inputs, params=params, deviations=found)
        write(files, made)
        s.publish(files, target)


if __name__ == "__main__":
    main()
