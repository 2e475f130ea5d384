"""Pictures of a step and of an episode, drawn without a viewer."""
