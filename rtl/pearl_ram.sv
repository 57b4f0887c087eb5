// SPDX-License-Identifier: MIT
// A memory with one write port and one read port and a register at its output, which a block RAM may have
// itself.
//
// A word that is read stands at the output READ_LATENCY cycles later and stays until the next one.
module pearl_ram
  import pearl_pkg::index_bits;
#(
    parameter int unsigned WIDTH = 32,
    parameter int unsigned DEPTH = 16,
    localparam int unsigned ADDR_BITS = index_bits(DEPTH)
) (
    input  logic                 clk_i,
    input  logic                 we_i,
    input  logic [ADDR_BITS-1:0] waddr_i,
    input  logic [    WIDTH-1:0] wdata_i,
    input  logic                 re_i,
    input  logic [ADDR_BITS-1:0] raddr_i,
    output logic [    WIDTH-1:0] rdata_o
);

  logic [WIDTH-1:0] rdata, rdata_q;

  pearl_memory #(
      .WIDTH(WIDTH),
      .DEPTH(DEPTH)
  ) u_memory (
      .clk_i,
      .we_i,
      .waddr_i,
      .wdata_i,
      .re_i,
      .raddr_i,
      .rdata_o(rdata)
  );

  always_ff @(posedge clk_i) rdata_q <= rdata;
  assign rdata_o = rdata_q;

endmodule
