"""Parts that several papers use: patches, detection, recognition, evaluation, figures, studies."""
