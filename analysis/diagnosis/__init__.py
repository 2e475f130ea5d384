"""Why was the agent sealed in? What its predicted map did to it, from the log alone.

======================  ==================================================================
`reach`                 what the agent believes it can reach, and what it could reach
`detect`                when its way out vanished, came back, or was nearly closed
`blocking`              the fewest false walls that have to be corrected for a way out
`opening`               the minimum cut in true free space that was closed
`passage`               what the floor plan looks like there
`blame`                 the history of each blocking cell: probability, observations, flicker
`remedy`                what would have helped: a threshold, a viewpoint, the fail-safe
`taxonomy`              names for what happened, each with a readable rule
`harms`                 the other ways in which a prediction hurts
`reliability`           how often predictions of a given confidence are right
`diagnosis`             all of this for one log
`corpus`                counts over many logs
`tables`,               the counts in a terminal; one row per sealing, for programs
`sealing_table`
`paragraph`, `record`,  a diagnosis in words, as JSON, as a page, on maps
`page`, `annotations`
======================  ==================================================================
"""
