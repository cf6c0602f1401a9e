"""Requirements of every adapter on an environment."""

from myowarp.bridge_gym import MyoWarpVectorEnv


def check_same_step(env: MyoWarpVectorEnv, output: str) -> None:
    """Raise ValueError unless an environment resets in the step that ends an episode, with such output."""
    if "autoreset_mode" not in env.metadata:
        raise ValueError(
            "the environment must be a vector environment, of gymnasium.make_vec(..., "
            f"autoreset_mode='SameStep', output={output!r}), got {type(env).__name__}"
        )
    mode = env.metadata["autoreset_mode"].value
    if mode != "SameStep" or env.output != output:
        raise ValueError(
            f"the environment must be made with autoreset_mode='SameStep' and output={output!r}, "
            f"got {mode!r} and {env.output!r}"
        )
