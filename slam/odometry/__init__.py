"""Store wheel odometry and model its errors."""
