"""The losses and targets as functions of tensors: each is one equation of a paper."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional


def logistic_loss(expert: Tensor, negatives: Sequence[tuple[float, Tensor]]) -> Tensor:
    """Eq. 3.2 of Luo (2019), E_pi[-log(1 - D)] + E_E[-log D], nats.

    `expert` [B] and each source of negatives hold logits, log D - log(1 - D). `negatives` are (weight, logits) pairs.
    The weights of the sources that have samples are normalised to 1, so expert and negatives count alike whatever the
    number of sources. With one source this is the equation of the thesis.
    """
    total = sum(weight for weight, logits in negatives if len(logits))
    loss = functional.softplus(-expert).mean()
    for weight, logits in negatives:
        if len(logits):
            loss = loss + weight / total * functional.softplus(logits).mean()
    return loss


def discard_top(logits: Tensor, fraction: float) -> Tensor:
    """The logits [B] without the highest `fraction` of them (AGILE; Bahdanau et al. 2019, section 3.2).

    When the policy is close to success, some of its steps are those of the expert. Without them among the negatives,
    the discriminator does not learn that they are wrong.
    """
    kept = len(logits) - int(fraction * len(logits))
    return logits.topk(kept, largest=False).values if kept < len(logits) else logits


def sqil_loss(expert: Tensor, rollouts: Tensor) -> Tensor:
    """Squared soft Bellman errors with reward 1 for the expert and 0 for the policy (SQIL; Reddy et al. 2020, eq. 7).

    `expert` and `rollouts` [B] hold Q(s, a) - gamma V(s'), the reward that Q implies for a fixed V(s').
    """
    return (expert - 1).pow(2).mean() + rollouts.pow(2).mean()


def iq_loss(expert: Tensor, rollouts: Tensor, value_drop: Tensor, chi: float) -> Tensor:
    """The negative of IQ-Learn's objective with a chi-square divergence (Garg et al. 2021, eq. 9 and section 5.2).

    `expert` and `rollouts` [B] hold the implied reward x = Q(s, a) - gamma V(s'). `value_drop` [B] holds
    V(s) - gamma V(s') for steps of both; its mean is (1 - gamma) V(s_0). The objective of an expert step is
    x - x^2 / (4 chi). The square is averaged over the policy's steps too, as the authors advise where rollouts are
    available.
    """
    both = torch.cat([expert, rollouts])
    return value_drop.mean() - expert.mean() + both.pow(2).mean() / (4 * chi)


def gradient_penalty(logits: Tensor, inputs: Sequence[Tensor]) -> Tensor:
    """E |d logit / d input|^2, centred on zero (Mescheder et al. 2018). `inputs` [B, ...] must require grad."""
    gradients = torch.autograd.grad(logits.sum(), inputs, create_graph=True)
    return torch.stack([gradient.flatten(1).pow(2).sum(1) for gradient in gradients]).sum(0).mean()


def vtrace(
    logp: Tensor,
    behaviour_logp: Tensor,
    rewards: Tensor,
    values: Tensor,
    mask: Tensor,
    gamma: float,
    clip: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """Value targets v_s and policy-gradient advantages of V-trace (Espeholt et al. 2018, eq. 1 and section 4.2).

    All tensors are [B, T]. `mask` is True for the steps of an episode and False after its end, where values and
    rewards count as 0: the end of an episode is a terminal state. rho is clipped at `clip`, c at min(1, `clip`).
    """
    ratio = (logp - behaviour_logp).exp() * mask
    rho, c = ratio.clamp(max=clip), ratio.clamp(max=min(1.0, clip))
    values = values * mask
    next_values = torch.cat([values[:, 1:], torch.zeros_like(values[:, :1])], dim=1)
    delta = rho * (rewards * mask + gamma * next_values - values)
    correction = torch.zeros_like(values[:, 0])
    corrections = []
    for t in reversed(range(values.shape[1])):
        correction = delta[:, t] + gamma * c[:, t] * correction
        corrections.append(correction)
    targets = values + torch.stack(corrections[::-1], dim=1)
    next_targets = torch.cat([targets[:, 1:], torch.zeros_like(targets[:, :1])], dim=1)
    advantages = rho * (rewards * mask + gamma * next_targets - values)
    return targets, advantages
