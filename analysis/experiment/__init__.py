"""The paper's experiment: which episodes, running them, and what they say."""
