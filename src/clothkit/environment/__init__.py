"""`clothkit/Fold-v0`, a Gymnasium environment (extra `gymnasium`): fold a cloth into a goal in the simulator."""

try:
    import gymnasium
except ImportError as missing:
    raise ImportError("gymnasium is not installed; pip install 'clothkit[gymnasium]' installs it") from missing

ID = "clothkit/Fold-v0"
"""Name of the environment, which `gymnasium.make` knows once this package is imported."""

if ID not in gymnasium.registry:
    gymnasium.register(ID, entry_point="clothkit.environment.fold:FoldEnv")
