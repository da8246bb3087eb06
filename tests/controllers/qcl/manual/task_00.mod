*****
; File Name : TASK_00.MOD
; Project   : EX_EANPOS
; Description: Positioning Control
*****
;-----
; Initialization work Axis
;-----
Axis:measure = 10000 ;Space in 1 around encoder(Um)
Axis:pulse = 40000 ;pulses/Rev encoder
Axis:maxvel = 100000 ;Maximum speed = Axis speed with
                    ;analog output to 10V (CALON/vout=100)
Axis:maxpos = 999999 ;Maximum quota
Axis:minpos = -999999 ;Minimum quota
Axis:maxfollerr = 10000 ;Following error
Axis:unitvel = 0 ;Unit time speed
Axis:decpt = 0 ;Decimal digits
Axis:rampmode = 0 ;Type of ramps used
Axis:taccdec = 100 ;Acceleration and deceleration time
Axis:tacc = 0 ;Acceleration time (not used)
Axis:tdec = 0 ;Deceleration time (not used)
Axis:tinvt = 0 ;Inversion time axis
Axis:toll = 5 ;Tolerance
Axis:toldly = 10 ;Delay activation time tolerance
Axis:prsmode = 0 ;Preset search type
Axis:prspos = 0 ;Preset quota
Axis:prmdir = 0 ;Preset search direction
Axis:prsvel = (20 * Axis:maxvel)/100 ;Preset speed (20% of the maximum speed)
Axis:sprsvel = (10 * Axis:maxvel)/100 ;Zero pulse search speed
                    ;(10% of the maximum speed)
Axis:offset = 0 ;Offset voltage
Axis:pgain = 10 ;Proportional gain
Axis:feedfw = 1000 ;Feedforward
Axis:integt = 0 ;Integral time
Axis:derivt = 0 ;Derivative time
INIT Axis ;Initializes the device
WAIT Axis:st_init ;Wait until the device is initialized
CNTUNLOCK Axis ;Unlock count
WAIT NOT Axis:st_cntlock ;Wait until the count is unlocked
CNTDIR Axis ;Sets the direction of the count
WAIT NOT Axis:st_cntrev ;Wait until it is set the direction
                    ;of the count
REGON Axis ;Enable the setting
WAIT NOT Axis:st_regoff ;Wait the enable for the RESUME axis adjustment
;Remove the axis from the State of emergency
;Wait until the axis is not in emergency
WAIT NOT Axis:st_emrg
LOOPON Axis
;Hook the loop of axis reaction
WAIT Axis:st_loopon
;Wait until it is hooked on the
;the reaction axis loop
IF (slVelAxis EQ 0)
;In case the set of speed
;the axle is zero
slVelAxis = 50
;Sets a positioning speed
ENDIF
;In the case that the axis quota
;of placement is zero
IF (slQuotaPos EQ 0)
slQuotaPos = 2000
;Sets a quota of positioning
ENDIF

;-----
; Positioning tasks
;-----
;----- variables used
;-----
; slVelAxis: Adjustable variable that represents the axis speed
; (expressed in % of the maximum speed)
; slQuotaPos: Adjustable variable that represents the quota of axis positioning
;----- flag used
;-----
; gfMovMan: manual operation in progress
; gfMovAuto: automatic operation in progress
;-----

MAIN:
;-----
; Outputs managing
;-----
ofToll = Axis:st_toll ;Forced out of tolerance as
;the tolerance state
ofAxeStopped = Axis:st_still ;Set the stopped axis as
;the stopped axis state

;-----
; Automatic movements managing
;-----
IF ifStart ;Waits for the START input
IF NOT gfMovMan ;Check that there are no manual movements
IF Axis:st_still ;Check that the axis is stopped
Axis:setvel=(slVelAxis*Axis:maxvel)/100 ;Sets the speed of the axis
Axis:setpos = slQuotaPos ;Sets the placement quota
START Axis ;Run the start of axis
gfMovAuto = 1 ;Automatic movement in progress reports
ENDIF
ENDIF
ENDIF
IF ifStop ;Waits for the STOP input
IF NOT Axis:st_still ;Check that the axle is not stopped
STOP Axis ;Run the stop of the axis
ENDIF
ENDIF
IF gfMovAuto ;Check reporting movement
;automatico in corso
IF Axis:st_still ;Check that the axis is stopped
gfMovAuto = 0 ;Reset the automatic movement state
ENDIF
ENDIF

;-----
; Manual movements managing
;-----
IF ifAvMan ;Awaiting the entry of manual operation
IF NOT (gfMovAuto OR gfMovMan) ;Check that there are no movements
;automatics or manuals
IF Axis:st_still ;Check that the axis is stopped
Axis:setvel=(slVelAxis*Axis:maxvel)/100 ;Sets the speed of the axis
MANFW Axis ;Forward axis in manual
gfMovMan = 1 ;Manual movement in progress reports
ENDIF
ENDIF
ENDIF
IF ifInMan ;Awaiting the manual operation input
IF NOT (gfMovAuto OR gfMovMan) ;Check that there are no movements
;automatics or manuals
IF Axis:st_still ;Check that the axis is stopped
Axis:setvel=(slVelAxis*Axis:maxvel)/100 ;Sets the speed of the axis
MANBW Axis ;Forward axis in manual
gfMovMan = 1 ;Manual movement in progress reports
ENDIF
ENDIF
ENDIF
IF gfMovMan ;If the axis moves in manual
IF NOT (ifAvMan OR ifInMan) ;If the forward and backward inputs
;manual is to OFF
STOP Axis ;Stop the axis
gfMovMan = 0 ;Remove the reporting of axis
;manual movement
ENDIF
ENDIF

;-----
; Final operations
;-----
WAIT 1
JUMP MAIN
END
