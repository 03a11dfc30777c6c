"""The learner for LanguageGridCraft: features, networks, soft Q-learning and the discriminator on grid steps."""
