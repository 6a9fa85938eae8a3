"""First-order stages that are nonlinear in themselves: tanks with their outflow and overflow."""

from ._tank_chain import TankChain, TankChainOperator

__all__ = ["TankChain", "TankChainOperator"]
