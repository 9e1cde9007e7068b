"""Where model and data disagree, outlier clips, and what held-out collisions say."""
