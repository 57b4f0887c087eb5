// SPDX-License-Identifier: MIT
// A memory of which one word is known, any one, and every other read gives anything. What is proved of a
// design with it holds with whole memories. No access goes beyond the last word.
module pearl_memory
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

  // The word's address, free in the first cycle and the same ever after.
  logic fixed_q = 1'b0;
  logic [ADDR_BITS-1:0] any_addr, addr_q, addr;
  assign addr = fixed_q ? addr_q : any_addr;

  logic [WIDTH-1:0] any_word, content_q, rdata_q;
  logic undefined;
  assign undefined = raddr_i != addr || (we_i && waddr_i == raddr_i);

  always_ff @(posedge clk_i) begin
    fixed_q <= 1'b1;
    addr_q  <= addr;
    if (we_i && waddr_i == addr) content_q <= wdata_i;
    if (re_i) rdata_q <= undefined ? any_word : content_q;
  end

  assign rdata_o = rdata_q;

  always_comb begin
    if (we_i) assert (32'(waddr_i) < DEPTH);
    if (re_i) assert (32'(raddr_i) < DEPTH);
  end

endmodule
