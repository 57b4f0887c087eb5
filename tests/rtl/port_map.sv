// SPDX-License-Identifier: MIT
// pearl_port in front of regions of REGION_WORDS words each, since a list of offsets cannot be given on
// a tool's command line.
module port_map
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned REGION_WORDS = 16,
    parameter int unsigned WORD_ADDR_BITS = 8
) (
    input  logic                                    clk_i,
    input  logic                                    rst_ni,
    input  logic                                    req_i,
    input  logic                                    we_i,
    input  logic                                    fetch_i,
    input  logic  [WORD_ADDR_BITS-1:0]              addr_i,
    input  logic  [       DATA_WL-1:0]              wdata_i,
    output logic                                    rvalid_o,
    output logic  [       DATA_WL-1:0]              rdata_o,
    output resp_e                                   resp_o,
    input  logic                                    busy_i,
    output logic  [    NumRegions-1:0]              re_o,
    output logic  [    NumRegions-1:0]              we_o,
    output logic  [WORD_ADDR_BITS-1:0]              index_o,
    output logic  [       DATA_WL-1:0]              wdata_o,
    output logic  [       DATA_WL-1:0]              next_wdata_o,
    input  logic  [    NumRegions-1:0][DATA_WL-1:0] rdata_i,
    input  logic  [       DATA_WL-1:0]              late_rdata_i,
    output logic                                    busy_write_o,
    output logic                                    busy_doorbell_o,
    output logic                                    untorn_o,
    output logic                                    soft_reset_o
);

  localparam int unsigned W = REGION_WORDS;

  pearl_port #(
      .DATA_WL(DATA_WL),
      .WORD_ADDR_BITS(WORD_ADDR_BITS),
      .OFFSETS(
      '{0, W, 2 * W, 3 * W, 4 * W, 5 * W, 6 * W, 7 * W, 8 * W, 9 * W, 10 * W, 11 * W, 12 * W, 13 * W}
      )
  ) u_port (
      .*
  );

endmodule
