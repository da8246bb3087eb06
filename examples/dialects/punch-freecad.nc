(Exported by FreeCAD)
(Post Processor: wedm_post)
(begin preamble)
G17 G54 G40 G49 G80 G90

G91
G21*
(begin operation: Profile)
(machine: Wire EDM, mm/min)
G01X+008000Y+001000*
G01Y+001000*
G01X-006000*
G01Y+006000*
G01X+008000*
G02X+002000Y-002000I+000000J-002000*
G01Y-004000*
G01X-004000*
(finish operation: Profile)
(begin postamble)
M05
G17 G54 G90 G80 G40
M2
