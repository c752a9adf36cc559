"""The paper's four simulations and others, as documents to read and run."""
