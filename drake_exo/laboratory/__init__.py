"""What a gait laboratory hands over, and how it becomes a Trial."""
