"""Nonlinear first-order stages: tanks with outflow and overflow."""

from ._tank_chain import TankChain, TankChainOperator

__all__ = ["TankChain", "TankChainOperator"]
