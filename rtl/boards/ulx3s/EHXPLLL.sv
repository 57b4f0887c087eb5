// SPDX-License-Identifier: MIT
// The ECP5's PLL as far as pearl_ulx3s.sv knows of it; the tools put their own in its place.
(* blackbox *)
module EHXPLLL #(
    parameter string PLLRST_ENA = "DISABLED",
    parameter string INTFB_WAKE = "DISABLED",
    parameter string STDBY_ENABLE = "DISABLED",
    parameter string DPHASE_SOURCE = "DISABLED",
    parameter string OUTDIVIDER_MUXA = "DIVA",
    parameter int CLKI_DIV = 1,
    parameter int CLKFB_DIV = 1,
    parameter string FEEDBK_PATH = "CLKOP",
    parameter string CLKOP_ENABLE = "ENABLED",
    parameter int CLKOP_DIV = 8,
    parameter int CLKOP_CPHASE = 0
) (
    input  logic CLKI,
    input  logic CLKFB,
    input  logic PHASESEL1,
    input  logic PHASESEL0,
    input  logic PHASEDIR,
    input  logic PHASESTEP,
    input  logic PHASELOADREG,
    input  logic STDBY,
    input  logic PLLWAKESYNC,
    input  logic RST,
    input  logic ENCLKOP,
    output logic CLKOP,
    output logic LOCK
);
endmodule
