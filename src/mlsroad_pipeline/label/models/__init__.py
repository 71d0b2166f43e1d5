"""Choice of the model that labels a survey."""
