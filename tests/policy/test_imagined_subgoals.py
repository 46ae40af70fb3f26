"""What the meta controller imagines from the prior, as in a rollout, has to follow the image."""

import pytest
import torch

from lerobot_buds.policy.meta_controller import MetaControllers

PIXELS, BATCH = 32, 64


def spots(places: torch.Tensor) -> torch.Tensor:
    """Draws a bright spot at each place ``(B, 2)`` in [-1, 1]."""
    axis = torch.linspace(-1, 1, PIXELS)
    x, y = places[:, 0, None, None] - axis, places[:, 1, None, None] - axis[:, None]
    return torch.exp(-8 * (x.square() + y.square()))[:, None].expand(-1, 3, -1, -1)


@pytest.mark.parametrize(
    ("settings", "follows"),
    [({}, True), ({"kl_weight": 1e-4, "decoder_sees_skill": False}, False)],
    ids=["ours", "published"],
)
def test_imagined_subgoals_follow_the_image(build, settings, follows):
    """With the published weight all goes through the latent: the training loss is lower, but acting is blind."""
    config = build(**settings).config
    torch.manual_seed(0)
    controllers = MetaControllers(config)
    optimizer = torch.optim.Adam(controllers.parameters(), lr=3e-3)
    none = torch.zeros(BATCH, dtype=torch.int64)
    for _ in range(400):
        # Half of the subgoal is in the image, half is a demonstrator's whim.
        seen, whim = torch.rand(2, BATCH, 2).mul(2).sub(1)
        losses = controllers.losses(spots(seen), none, none, torch.cat([seen, whim], dim=1))
        optimizer.zero_grad()
        (losses.subgoal_loss + config.kl_weight * losses.kl_loss).mean().backward()
        optimizer.step()
    controllers.eval()
    losses = controllers.losses(spots(seen), none, none, torch.cat([seen, whim], dim=1))
    explained = 1 - float(losses.imagined_subgoal_loss.mean() / losses.subgoal_spread.mean())
    assert (explained > 0.3) is follows, explained
