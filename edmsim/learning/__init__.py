"""Learning feed controllers: training with stable-baselines3, and policies that leave it as plain arrays."""
