"""Pool of the boosted trees and the superpoint transformer, the default model."""
