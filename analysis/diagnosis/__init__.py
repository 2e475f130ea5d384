"""Why was the agent sealed in? What its predicted map did to it, from the log alone.

======================  ==================================================================
`reach`                 what the agent believes that it can reach, and what it truly could
`detect`                when its way out vanished, came back, or was nearly closed
`culprits`              the fewest false walls that, set right, open a way out
`doorway`               the bottleneck in true free space that was closed
`blame`                 the history of each culprit: probability, observations, flicker
`remedy`                what would have helped: a threshold, a view, the fail-safe
`taxonomy`              names for what happened, each with a rule that can be read
`harms`                 the other ways in which a prediction hurts
`diagnosis`             all of this for one log
`corpus`, `frame`       counted over many; one row a sealing
`paragraph`, `record`,  told to a person, to a program, on a page, in the viewer
`page`, `marks`
======================  ==================================================================
"""
