"""What two papers share: patches, detection, recognition, evaluation, figures, studies."""
