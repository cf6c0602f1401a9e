"""Requirements of every adapter on an environment."""

from myowarp.bridge_gym import MyoWarpVectorEnv


def check_same_step(env: MyoWarpVectorEnv, output: str) -> None:
    """Raise ValueError unless an environment resets in the step that ends an episode, with such output."""
    mode = env.metadata["autoreset_mode"].value
    if mode != "SameStep" or env.output != output:
        raise ValueError(
            f"the environment must be made with autoreset_mode='SameStep' and output={output!r}, "
            f"got {mode!r} and {env.output!r}"
        )
