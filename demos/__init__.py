"""The paper's four simulations."""
